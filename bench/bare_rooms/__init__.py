"""White rooms with little to recognise: what is located there, and by which features."""
