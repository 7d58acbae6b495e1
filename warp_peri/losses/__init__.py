"""What is minimised: residuals, reduced and in full, responses, and what noise adds."""
