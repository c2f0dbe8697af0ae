"""The pages of approvals and gates."""
