"""Plans of experiments, drawn and checked."""
