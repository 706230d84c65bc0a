"""Pages, tables and plots of figures."""
