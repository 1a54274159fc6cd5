"""Where one parameter set can be trusted: held-out errors, a map of them, pictures, the answer."""
