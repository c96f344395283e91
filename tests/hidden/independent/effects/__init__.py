"""Effects of real rigs that neither the catalogue nor `tests.hidden.truth.outside` has."""
