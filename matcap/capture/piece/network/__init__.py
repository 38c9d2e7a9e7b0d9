"""The network that reads one flash photograph as maps of the photographed piece."""
