"""Published experiments: predictions from inputs alone, and their comparison with measurements."""
