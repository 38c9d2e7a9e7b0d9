"""Settings of all tests."""

from hypothesis import HealthCheck, settings

# How fast a busy machine makes examples up is no property of the code under test.
settings.register_profile("matcap", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("matcap")
