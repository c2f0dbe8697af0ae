"""The one look of every chart: theme, axes, thinning, quantities."""
