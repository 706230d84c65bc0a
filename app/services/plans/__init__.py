"""Indoor maps into venues and out of them."""
