"""Environments: the interface (`base`), the arms (`arms`) and the reaching task on MJX (`reach`)."""
