"""Who may call: keys, limits of their use, and the log of what administrators did."""
