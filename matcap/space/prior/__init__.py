"""The prior over materials [henzler2021]: its file, its shipped weights, and draws from it."""
