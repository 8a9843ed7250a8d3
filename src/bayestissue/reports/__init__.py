"""What people read: tables, figures, pages, and the kit for a paper."""
