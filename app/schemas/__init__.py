"""What requests and answers of the HTTP interface look like."""
