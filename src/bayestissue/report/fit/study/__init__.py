"""What a lab asks of a study: who and what differs, how repeatable it is, how methods agree."""
