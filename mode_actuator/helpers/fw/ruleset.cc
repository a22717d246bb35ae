#include "mode_actuator/helpers/fw/ruleset.h"

#include <utility>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/strip.h"
#include "mode_actuator/steps/firewall/target.h"
#include "nlohmann/json.hpp"

namespace rips::actuator {
namespace {

using Json = nlohmann::json;

std::string TextOf(const Json& object, const char* key) {
  const auto found = object.find(key);
  return found != object.end() && found->is_string() ? found->get<std::string>() : std::string();
}

int64_t NumberOf(const Json& object, const char* key) {
  const auto found = object.find(key);
  return found != object.end() && found->is_number_integer() ? found->get<int64_t>() : 0;
}

// Of a counter.
std::optional<uint64_t> PacketsOf(const Json& counter) {
  const auto packets = counter.find("packets");
  if (packets == counter.end() || !packets->is_number_unsigned()) return std::nullopt;
  return packets->get<uint64_t>();
}

// What moves while packets pass is no part of a rule.
void DropMoving(Json& value) {
  if (value.is_object()) {
    if (const auto counter = value.find("counter"); counter != value.end()) *counter = nullptr;
    if (const auto quota = value.find("quota"); quota != value.end() && quota->is_object()) {
      quota->erase("used");
      quota->erase("used_unit");
    }
  }
  if (!value.is_structured()) return;
  for (auto& each : value) DropMoving(each);
}

// A GUID prefix comes as a number without leading zeros; small ones as a JSON number.
std::string Padded(absl::string_view digits) {
  if (digits.size() > 24) return std::string(digits);
  return absl::StrCat(std::string(24 - digits.size(), '0'), digits);
}

std::string ValueText(const Json& value, bool guids) {
  if (value.is_number_unsigned()) {
    if (guids) return Padded(absl::StrCat(absl::Hex(value.get<uint64_t>())));
    return absl::StrCat(value.get<uint64_t>());
  }
  if (value.is_string()) {
    const std::string text = value.get<std::string>();
    absl::string_view digits = text;
    if (guids && absl::ConsumePrefix(&digits, "0x")) return Padded(digits);
    return text;
  }
  if (value.is_object() && value.contains("concat") && value["concat"].is_array()) {
    std::string joined;
    for (const Json& part : value["concat"]) {
      absl::StrAppend(&joined, joined.empty() ? "" : " . ", ValueText(part, guids));
    }
    return joined;
  }
  return value.dump();
}

SetElement ElementOf(const Json& entry, bool guids) {
  if (!entry.is_object() || !entry.contains("elem") || !entry["elem"].is_object()) {
    return {.value = ValueText(entry, guids)};
  }
  const Json& body = entry["elem"];
  SetElement element;
  if (body.contains("val")) element.value = ValueText(body["val"], guids);
  element.expires_s = NumberOf(body, "expires");
  if (body.contains("counter")) element.packets = PacketsOf(body["counter"]).value_or(0);
  const std::string comment = TextOf(body, "comment");
  absl::string_view since = comment;
  if (!absl::ConsumePrefix(&since, "since ") || !absl::SimpleAtoi(since, &element.since_s)) {
    element.since_s = 0;
  }
  return element;
}

void ReadChain(const Json& body, Ruleset& ruleset) {
  ChainView& chain = ruleset.chains[TextOf(body, "name")];
  const std::string hook = TextOf(body, "hook");
  if (hook.empty()) return;
  chain.base = absl::StrCat(TextOf(body, "type"), " ", hook, " ", NumberOf(body, "prio"), " ",
                            TextOf(body, "policy"));
}

void ReadSet(const Json& body, Ruleset& ruleset) {
  const std::string name = TextOf(body, "name");
  std::vector<SetElement>& elements = ruleset.sets[name];
  const auto listed = body.find("elem");
  if (listed == body.end() || !listed->is_array()) return;
  for (const Json& entry : *listed) elements.push_back(ElementOf(entry, name == "bad_guid"));
}

void ReadRule(const Json& body, Ruleset& ruleset) {
  ChainView& chain = ruleset.chains[TextOf(body, "chain")];
  Json expr = body.contains("expr") ? body["expr"] : Json();
  DropMoving(expr);
  chain.rules.push_back(expr.dump(-1, ' ', false, Json::error_handler_t::replace));
  chain.comments.push_back(TextOf(body, "comment"));
}

}  // namespace

absl::StatusOr<Ruleset> ParseRuleset(absl::string_view json) {
  const Json root = Json::parse(json.begin(), json.end(), nullptr, /*allow_exceptions=*/false);
  if (!root.is_object() || !root.contains("nftables") || !root["nftables"].is_array()) {
    return absl::DataLossError("what nft printed is no list of rules");
  }
  Ruleset ruleset;
  for (const Json& entry : root["nftables"]) {
    if (!entry.is_object()) continue;
    for (const auto& [what, body] : entry.items()) {
      if (!body.is_object()) continue;
      if (what == "table") {
        ruleset.present = true;
        // nft 1.0.6 prints no flags for a table that has none, and nonsense for one that has.
        ruleset.dormant = body.contains("flags");
      } else if (what == "chain") {
        ReadChain(body, ruleset);
      } else if (what == "set") {
        ReadSet(body, ruleset);
      } else if (what == "rule") {
        ReadRule(body, ruleset);
      } else if (what == "counter" && TextOf(body, "name") == "dropped") {
        ruleset.dropped = PacketsOf(body);
      }
    }
  }
  return ruleset;
}

}  // namespace rips::actuator
