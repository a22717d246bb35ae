// What commands print as JSON.
#ifndef RIPS_POLICY_SERVER_RIPSCTL_CLI_JSON_OUTPUT_H_
#define RIPS_POLICY_SERVER_RIPSCTL_CLI_JSON_OUTPUT_H_

#include <nlohmann/json.hpp>
#include <string>
#include <type_traits>

#include "policy_server/ripsctl/cli/env.h"
#include "policy_server/ripsctl/cli/json_view.h"

namespace rips::ripsctl {

// As a command's whole result.
inline ExitCode PrintJson(Env& env, const Json& json) {
  PrintJson(json, env.out);
  return ExitCode::kDone;
}

// Each of `range` as `to_json` gives it.
template <typename Range, typename Convert>
Json JsonList(const Range& range, const Convert& to_json) {
  Json list = Json::array();
  for (const auto& each : range) list.push_back(to_json(each));
  return list;
}

// Each of `range`: a text, or a message that ToJson takes.
template <typename Range>
Json JsonList(const Range& range) {
  return JsonList(range, [](const auto& each) -> Json {
    if constexpr (std::is_convertible_v<decltype(each), std::string>) {
      return each;
    } else {
      return ToJson(each);
    }
  });
}

}  // namespace rips::ripsctl

#endif  // RIPS_POLICY_SERVER_RIPSCTL_CLI_JSON_OUTPUT_H_
