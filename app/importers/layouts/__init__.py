"""Layouts of files that data sets and other programs have."""
