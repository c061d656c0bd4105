"""Effects: what reality does and the baseline lacks. One effect, one module; `catalogue` lists them."""
