"""The network: noise, decoder, encoder, freezing, and the material file."""
