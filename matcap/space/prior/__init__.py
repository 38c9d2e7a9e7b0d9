"""The space of materials that captures start from: its file, its shipped weights, what it draws."""
