"""Multi-view estimation of the exemplar from several photographs of one sample."""
