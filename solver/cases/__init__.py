"""What is asked of a model, and what follows before it moves: parameters, start, step size."""
