"""Why K seems to grow with the mass: campaigns in which one cause acts, set beside what was observed.

A batch of campaigns is drawn from a cause's prior, recorded, estimated by the pipeline that the data went
through, and boiled down to a few statistics; `checks` and `attribution` say what these tell of the cause.
"""
