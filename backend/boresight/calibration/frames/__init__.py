"""Single frames of a run: every detection, its star, its residual."""
