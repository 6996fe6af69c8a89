"""What all backgrounds that plan share: futures, lanes ahead, who may attack, and the safeguard over every plan."""
