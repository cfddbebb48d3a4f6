"""What is computed once, at initialization: gains and covariances."""
