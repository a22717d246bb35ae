// The command line as data, read from the parser itself: the source of the completion for shells
// and of the manual page, as of `--help`.
#ifndef RIPS_POLICY_SERVER_RIPSCTL_REFERENCE_COMMAND_TREE_H_
#define RIPS_POLICY_SERVER_RIPSCTL_REFERENCE_COMMAND_TREE_H_

#include <string>
#include <vector>

namespace CLI {
class App;
}

namespace rips::ripsctl {

// A flag, or an argument without one.
struct FlagDoc {
  std::vector<std::string> names;    // `-h`, `--help`; for an argument `ROBOT`
  std::string value;                 // `TEXT`, `text|json`; empty = takes none
  std::string limits;                // `INT in [1 - 1000]`; empty = any value
  std::string fallback;              // what it is when not given; may be empty
  std::vector<std::string> choices;  // all values that it may have; empty = others, too
  std::string text;
  bool required = false;
  bool repeated = false;
};

struct CommandDoc {
  std::string words;  // `robot list`; empty for the program
  std::string synopsis;
  std::vector<FlagDoc> arguments;
  std::vector<FlagDoc> flags;
  std::vector<CommandDoc> commands;  // in the order of --help, without hidden ones
};

// Of the whole tree in which `app` is.
CommandDoc DescribeCommands(const CLI::App& app);

}  // namespace rips::ripsctl

#endif  // RIPS_POLICY_SERVER_RIPSCTL_REFERENCE_COMMAND_TREE_H_
