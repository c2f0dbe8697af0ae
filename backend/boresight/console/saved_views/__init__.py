"""Views of pages under a name, and favourites."""
