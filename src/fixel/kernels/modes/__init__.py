"""Contact modes of quasi-static motion, followed from event to event."""
