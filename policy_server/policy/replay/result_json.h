// Results as JSON; a contract, to which fields may be added. Text that is no UTF-8 is the printer's
// business.
#ifndef RIPS_POLICY_SERVER_POLICY_REPLAY_RESULT_JSON_H_
#define RIPS_POLICY_SERVER_POLICY_REPLAY_RESULT_JSON_H_

#include <nlohmann/json.hpp>

#include "policy_server/policy/replay/compare.h"
#include "policy_server/policy/replay/result.h"

namespace rips::replay {

// {"events":{"message","graph","external","undecidable"},"level",
//  "transitions":[{"event","rule","from","to","result":"decided|refused"}],
//  "alerts":[{"event","rule","text","severity"}],
//  "execs":[{"event","rule","program","args":[..],"result":"ok|failed"}],
//  "variables":{name:value},"faults":[{"event","rule","text"}],
//  "rules":[{"name","section":"Msg|Graph|External","evaluated","fired","ns_mean"}]}
// and, only if there is any: "logs":[{"event","rule","text"}] (of `True` and `False`),
// "missing":[{"after":event|null,"seconds","end":bool,"text"}],
// "crashed":event, "left_out":count, "unattributed":count in "events", "undecidable":count and
// "unscanned":count in an entry of "rules".
nlohmann::ordered_json ToJson(const Result& result);

// {"same":bool,"first_difference":event|null,"level":{"before","after"},
//  "transitions":{"before":[..],"after":[..]},"alerts":{..},"execs":{..},
//  "variables":{"before":{name:value},"after":{name:value}}}: what only one of the two has, or has
// otherwise; and "left_out":true if lists were cut, which are compared as far as they go.
nlohmann::ordered_json ToJson(const Difference& difference);

// A bool, a number, or a string: texts, and numbers that JSON or its readers do not hold: NaN,
// +Inf, -Inf, and integers beyond 2^53.
nlohmann::ordered_json ToJson(const lang::Value& value);

}  // namespace rips::replay

#endif  // RIPS_POLICY_SERVER_POLICY_REPLAY_RESULT_JSON_H_
