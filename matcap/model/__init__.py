"""The network and what it makes: noise, decoder, freezing; blocks of its field; the material."""
