// Reads a compose file with the reference library of the Compose specification, and prints what it means as JSON:
// defaults filled in, variables replaced, paths absolute. Exits with 1, and says where the file is wrong, if it breaks
// the specification's schema or contradicts itself.
//
//	go run . -f FILE [-f OVERRIDE ...]
package main

import (
	"context"
	"fmt"
	"os"

	"github.com/compose-spec/compose-go/v2/cli"
)

func main() {
	files, err := parseArguments(os.Args[1:])
	if err == nil {
		err = printProject(files)
	}
	if err != nil {
		fmt.Fprintln(os.Stderr, "compose_check:", err)
		os.Exit(1)
	}
}

func parseArguments(words []string) ([]string, error) {
	var files []string
	for i := 0; i < len(words); i += 2 {
		if words[i] != "-f" || i+1 == len(words) {
			return nil, fmt.Errorf("usage: compose_check -f FILE [-f OVERRIDE ...]")
		}
		files = append(files, words[i+1])
	}
	if len(files) == 0 {
		return nil, fmt.Errorf("usage: compose_check -f FILE [-f OVERRIDE ...]")
	}
	return files, nil
}

func printProject(files []string) error {
	// As `docker compose` does: the environment, then the .env file beside the first compose file.
	options, err := cli.NewProjectOptions(files, cli.WithOsEnv, cli.WithDotEnv, cli.WithResolvedPaths(true))
	if err != nil {
		return err
	}
	project, err := options.LoadProject(context.Background())
	if err != nil {
		return err
	}
	document, err := project.MarshalJSON()
	if err != nil {
		return err
	}
	_, err = fmt.Println(string(document))
	return err
}
