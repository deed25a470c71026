"""Decides when to try again, when periodic work is due, and how many bytes a host may send ahead. Pure."""
