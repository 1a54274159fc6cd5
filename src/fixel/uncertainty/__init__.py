"""What measurements leave open of parameters, and what follows from it for predictions."""
