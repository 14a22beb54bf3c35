"""Settings of every test: examples that are the same each time, and no bound on the time that one takes."""

from hypothesis import HealthCheck, settings

settings.register_profile(
    "goldfield",
    deadline=None,  # a loaded machine is slow
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("goldfield")
