"""Terms and priors as one log density: collapsed block, what is drawn back, what is predicted."""
