"""The angular-momentum balance: terms that add up, their columns, weights and noise."""
