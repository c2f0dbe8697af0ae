"""What people and machines do with Boresight: one function a use case, authorised and audited where it acts."""
