"""The pages of the way to orbit."""
