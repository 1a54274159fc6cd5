"""Plans of experiments: which configurations to try."""
