"""What a page needs to know: forms, progress, details, lists."""
