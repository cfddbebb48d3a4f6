"""What is computed once for a set of parameters or a step size: gains, covariances and their figures."""
