"""What captures are measured by: statistics of relit pictures, and maps against true ones."""
