"""Why a policy steers as it does."""
