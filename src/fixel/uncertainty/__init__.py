"""What follows from what is not known: outcome fans, posteriors, indices, bands; no files."""
