"""Reference solutions, written from the equations and not from the code, and the tests that use them."""
