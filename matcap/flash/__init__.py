"""What a flash photograph of a flat material looks like: its geometry and its rendering."""
