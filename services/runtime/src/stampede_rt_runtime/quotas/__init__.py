"""Quotas: how much of each port and host one caller may use, and the use of it."""
