// Verdict: what an inspection says of one message.
#ifndef RIPS_POLICY_SERVER_POLICY_ENGINE_STATE_VERDICT_H_
#define RIPS_POLICY_SERVER_POLICY_ENGINE_STATE_VERDICT_H_

namespace rips::engine {

enum class Verdict {
  kNo,
  kYes,
  // It was not told: no payload, no time, a scanner or plugin that failed.
  kUnscanned,
};

}  // namespace rips::engine

#endif  // RIPS_POLICY_SERVER_POLICY_ENGINE_STATE_VERDICT_H_
