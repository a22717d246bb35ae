// Which kinds of findings of a robot's sensors stand, as rules see them.
#ifndef RIPS_POLICY_SERVER_POLICY_ENGINE_STATE_STANDING_FINDINGS_H_
#define RIPS_POLICY_SERVER_POLICY_ENGINE_STATE_STANDING_FINDINGS_H_

#include <cstdint>
#include <optional>
#include <vector>

#include "absl/strings/string_view.h"

namespace rips::engine {

// A value of two bytes: each judged event is recorded with its own.
class StandingFindings {
 public:
  // What rules call all kinds together, those that they cannot name among them.
  static constexpr absl::string_view kAny = "any";
  // What Kinds() calls all kinds that rules cannot name.
  static constexpr absl::string_view kOther = "other";

  // Nothing is known.
  StandingFindings() = default;
  // What is not added does not stand, if the sensors have told all that does.
  explicit StandingFindings(bool told_all) { set_told_all(told_all); }

  // One of that kind stands.
  void Add(absl::string_view kind);

  // Whether one of `kind` stands, which may be kAny. nullopt = not known.
  std::optional<bool> Stands(absl::string_view kind) const;

  bool told_all() const { return (bits_ & kToldAll) != 0; }
  void set_told_all(bool told_all) {
    bits_ = static_cast<uint16_t>((bits_ & ~kToldAll) | (told_all ? kToldAll : 0));
  }
  // In the order of the rule language. Valid for ever.
  std::vector<absl::string_view> Kinds() const;

  friend bool operator==(const StandingFindings&, const StandingFindings&) = default;

 private:
  static constexpr uint16_t kToldAll = 1 << 15;
  static constexpr uint16_t kOtherBit = 1 << 14;

  static uint16_t BitOf(absl::string_view kind);

  uint16_t bits_ = 0;
};

}  // namespace rips::engine

#endif  // RIPS_POLICY_SERVER_POLICY_ENGINE_STATE_STANDING_FINDINGS_H_
