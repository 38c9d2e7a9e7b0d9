"""Where the cameras of several photographs of one flat piece stood."""
