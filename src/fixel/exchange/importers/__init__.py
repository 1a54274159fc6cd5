"""From recorded data to experiments: a reader for each dataset, and one for your own tables."""
