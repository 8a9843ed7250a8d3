"""Planning a study: what it will tell, before anyone is hit."""
