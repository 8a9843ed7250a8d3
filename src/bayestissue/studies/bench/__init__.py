"""Pages that answer: a recorder's drops are judged as they come, a dataset is looked at, a fit asked."""
