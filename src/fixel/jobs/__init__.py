"""Work that runs elsewhere: many processes, or a cluster."""
