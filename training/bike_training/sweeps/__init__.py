"""Many runs from one file: what they are, who does them, and the tables that come of them."""
