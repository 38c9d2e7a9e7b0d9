"""Registration: camera poses of several photographs of one flat sample."""
