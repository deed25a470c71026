"""Callers that cancel the steps of iterators, and callbacks that exit."""
