"""Whether data and model fit together: the measuring chain, the model's form, straight lines; the verdict."""
