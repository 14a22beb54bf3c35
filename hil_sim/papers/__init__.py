"""The sources' experiments, repeated: the one place where the simulated world meets the host's model."""
