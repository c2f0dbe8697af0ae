"""Everything that is kept: rows in a database, bytes in a folder. The only floor that speaks SQL."""
