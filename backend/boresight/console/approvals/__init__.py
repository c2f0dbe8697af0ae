"""Requests for approval, the gates and waivers they rest on, and the signatures that decide them."""
