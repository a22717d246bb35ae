// A rule's trace as rips.v1.Evidence: on the wire, and in the state file.
#ifndef RIPS_POLICY_SERVER_SERVER_STORE_TRACE_CODEC_H_
#define RIPS_POLICY_SERVER_SERVER_STORE_TRACE_CODEC_H_

#include <string>

#include "absl/strings/string_view.h"
#include "policy_server/policy/engine/state/trace.h"
#include "rips/v1/operator.pb.h"
#include "services/model/observation.h"

namespace rips::store {

// Of text that is not UTF-8 the bytes are escaped.
rips::v1::Evidence EncodeTrace(const engine::Trace& trace);
rips::v1::Subject EncodeSubject(const engine::TracedSubject& subject);
rips::v1::Finding EncodeFinding(const model::Finding& finding);

// Serialized; empty for none.
std::string TraceToBytes(const engine::Trace& trace);
// None for what TraceToBytes did not make.
engine::Trace TraceFromBytes(absl::string_view bytes);

}  // namespace rips::store

#endif  // RIPS_POLICY_SERVER_SERVER_STORE_TRACE_CODEC_H_
