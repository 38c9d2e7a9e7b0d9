"""The photographed piece itself, made to repeat: level, straight, cut where it shows least."""
