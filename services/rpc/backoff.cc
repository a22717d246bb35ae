#include "services/rpc/backoff.h"

#include <algorithm>
#include <utility>

namespace rips::rpc {

Backoff::Backoff(const BackoffPolicy& policy, Random random)
    : policy_(policy), random_(std::move(random)), next_(policy.initial) {}

absl::Duration Backoff::Next() {
  const absl::Duration delay = std::min(next_, policy_.max);
  next_ = std::min(2 * delay, policy_.max);
  return delay * (1 + policy_.jitter * (2 * random_() - 1));
}

CloseClass ClassifyClose(absl::StatusCode code) {
  switch (code) {
    case absl::StatusCode::kUnauthenticated:
      return CloseClass::kReidentify;
    case absl::StatusCode::kAlreadyExists:
      return CloseClass::kSecondSession;
    case absl::StatusCode::kPermissionDenied:
    case absl::StatusCode::kUnimplemented:
    case absl::StatusCode::kFailedPrecondition:
    case absl::StatusCode::kInvalidArgument:
      return CloseClass::kRefused;
    default:
      return CloseClass::kRetry;
  }
}

absl::string_view CloseClassName(CloseClass close_class) {
  switch (close_class) {
    case CloseClass::kRetry:
      return "retry";
    case CloseClass::kReidentify:
      return "reidentify";
    case CloseClass::kSecondSession:
      return "second_session";
    case CloseClass::kRefused:
      return "refused";
  }
  return "";
}

ReconnectPacer::ReconnectPacer(const BackoffPolicy& retry, Random random)
    : retry_(retry, random),
      second_session_({.initial = absl::Seconds(1), .max = absl::Seconds(2)}, random),
      refused_({.initial = absl::Seconds(1), .max = absl::Minutes(1)}, random) {}

absl::Duration ReconnectPacer::Next(CloseClass close_class) {
  switch (close_class) {
    case CloseClass::kRetry:
    case CloseClass::kReidentify:
      return retry_.Next();
    case CloseClass::kSecondSession:
      return second_session_.Next();
    case CloseClass::kRefused:
      return refused_.Next();
  }
  return refused_.Next();
}

void ReconnectPacer::MessageReceived() {
  retry_.Reset();
  second_session_.Reset();
  refused_.Reset();
}

}  // namespace rips::rpc
