"""Large answers: made once for all who ask, and written no faster than they are read."""
