"""Charts of the trust examination and of residuals."""
