"""Effects: what reality does and the baseline lacks. One effect, one class; `catalogue` lists them."""
