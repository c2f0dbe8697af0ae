"""Help: the glossary, and every setting with its meaning."""
