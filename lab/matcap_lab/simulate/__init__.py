"""Materials with known truth and the flash photographs a camera would take of them."""
