"""Campaigns: one setting over many sensors."""
