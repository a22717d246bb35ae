// DecisionId on the wire.
#ifndef RIPS_SERVICES_MODEL_PROTO_DECISION_ID_CODEC_H_
#define RIPS_SERVICES_MODEL_PROTO_DECISION_ID_CODEC_H_

#include "rips/v1/session.pb.h"
#include "services/base/decision_id.h"

namespace rips::model_proto {

inline DecisionId Decode(const rips::v1::DecisionId& wire) {
  return {.term = wire.term(), .epoch = wire.epoch()};
}

inline void Encode(const DecisionId& decision_id, rips::v1::DecisionId& wire) {
  wire.set_term(decision_id.term);
  wire.set_epoch(decision_id.epoch);
}

}  // namespace rips::model_proto

#endif  // RIPS_SERVICES_MODEL_PROTO_DECISION_ID_CODEC_H_
