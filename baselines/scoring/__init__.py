"""Episodes flown by many policies, measured and compared."""
