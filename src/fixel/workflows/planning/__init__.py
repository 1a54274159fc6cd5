"""Planning of open-loop pushes."""
