// Stored records as operators see them, and what is told of one of them.
#ifndef RIPS_POLICY_SERVER_SERVER_OPERATOR_API_RECORD_CODEC_H_
#define RIPS_POLICY_SERVER_SERVER_OPERATOR_API_RECORD_CODEC_H_

#include <cstddef>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "policy_server/server/store/store.h"
#include "rips/v1/operator.pb.h"
#include "services/base/decision_id.h"

namespace rips::operator_api {

// Hex digits of an id, and how many of the first must be given.
inline constexpr size_t kIdDigits = 32;
inline constexpr size_t kIdDigitsMin = 6;
// True of what may be the beginning of an id, or all of it.
bool IsIdPrefix(absl::string_view id);

rips::v1::Alert Encode(const store::AlertRecord& alert);
rips::v1::Transition Encode(const store::TransitionRecord& record);

// As rips/v1/operator.proto says of Explain. Blocks on the store. InvalidArgument if the request
// names nothing or several, NotFound if there is no such record.
absl::StatusOr<rips::v1::ExplainResponse> Explain(const rips::v1::ExplainRequest& request,
                                                  store::Store& store);

}  // namespace rips::operator_api

#endif  // RIPS_POLICY_SERVER_SERVER_OPERATOR_API_RECORD_CODEC_H_
