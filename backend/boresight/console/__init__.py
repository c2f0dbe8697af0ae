"""The console: one folder a noun, each with its tables, queries, services, routes, schemas and pages.

Every table is known before any is used: seals, migrations and foreign keys are about all of them.
"""

from boresight.console import tables

__all__ = ["tables"]
