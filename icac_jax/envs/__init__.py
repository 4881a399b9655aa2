"""Environments: the interface (`base`), the arms (`arms`, `model`, `physics`) and reaching with them (`reach`)."""
