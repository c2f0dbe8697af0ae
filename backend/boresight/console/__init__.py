"""The console: one folder a noun, each with its tables, queries, services, routes, schemas and pages."""
