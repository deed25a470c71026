"""Values to and from protobuf. Of the client, only these modules and its shells use stubs."""
