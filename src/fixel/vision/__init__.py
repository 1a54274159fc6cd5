"""Pictures and poses: cameras, marks, tracking, and pictures of what a simulation does."""
