"""Training of the inverse network on endless simulated photographs."""
