"""Map versions over HTTP: which there are, and what pages draw of them."""
