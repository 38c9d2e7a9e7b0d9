"""Experiments behind the documentation's claims: appearance of captures under new lights."""
