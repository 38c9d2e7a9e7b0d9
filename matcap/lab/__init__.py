"""The laboratory: what simulates, measures and trains. The product never imports it."""
