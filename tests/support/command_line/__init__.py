"""Rigs for commands of the command line."""
