"""The laboratory: simulate, measure, bench, train. The product never imports it; only cli does."""
