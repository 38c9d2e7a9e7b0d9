"""Experiments: subjects x configurations x measures -> one CSV, one table, one plot, one page."""
