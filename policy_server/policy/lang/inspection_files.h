// What the checker asks about the files that `payload` and `plugin` name. The language itself opens
// nothing.
#ifndef RIPS_POLICY_SERVER_POLICY_LANG_INSPECTION_FILES_H_
#define RIPS_POLICY_SERVER_POLICY_LANG_INSPECTION_FILES_H_

#include <string>
#include <vector>

#include "policy_server/policy/lang/checked_rules.h"

namespace rips::lang {

struct InspectionProblem {
  enum class Kind {
    kMissing,  // not there, or not to be read or run
    kBroken,   // does not compile, or is not what it must be
    kSlow,     // compiles, but would slow every scan down
  };
  Kind kind = Kind::kBroken;
  // For people: `yara/x.yar:12: undefined identifier "a"`.
  std::string message;
};

class InspectionFiles {
 public:
  virtual ~InspectionFiles() = default;
  // Everything wrong with it; empty if it can be used. Runs nothing.
  virtual std::vector<InspectionProblem> Check(const Inspection& inspection) = 0;
};

}  // namespace rips::lang

#endif  // RIPS_POLICY_SERVER_POLICY_LANG_INSPECTION_FILES_H_
