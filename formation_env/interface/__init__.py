"""What the three faces share: their arguments, actions and results, and the `spec` of Gymnasium."""
