"""Any rectangle of the endless field of a material."""
