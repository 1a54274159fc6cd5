"""Planning of open-loop pushes that succeed despite unknown parameters, starts and errors."""
