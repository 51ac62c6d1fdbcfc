"""What is believed before the data: distributions, priors files, the space that is walked."""
