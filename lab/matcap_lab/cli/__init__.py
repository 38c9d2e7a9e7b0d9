"""The command `matcap-lab`."""
