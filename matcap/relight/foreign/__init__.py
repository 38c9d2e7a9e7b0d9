"""Map sets that matcap did not make, told apart by their files' names."""
