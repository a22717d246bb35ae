#include "policy_server/server/operator_api/caller_quota.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "services/rpc/status_conversion.h"

namespace rips::operator_api {
namespace {

constexpr int64_t kExpireEveryNs = 60 * kNanosPerSecond;

const char* NameOf(Use use) {
  switch (use) {
    case Use::kStream:
      return "streams";
    case Use::kQuery:
      return "calls";
    case Use::kOrder:
      return "orders";
  }
  return "";
}

}  // namespace

const QuotaLimits::Rate& CallerQuota::RateOf(Use use) const {
  return use == Use::kStream  ? limits_.streams
         : use == Use::kQuery ? limits_.queries
                              : limits_.orders;
}

void CallerQuota::Fill(Account& account, const QuotaLimits::Rate& rate, int64_t now_ns) const {
  const double passed_s =
      static_cast<double>(now_ns - account.filled_ns) / static_cast<double>(kNanosPerSecond);
  account.tokens = std::min(rate.burst, account.tokens + passed_s * rate.per_second);
  account.reserve = std::min(rate.reserve, account.reserve + passed_s * rate.lasting_per_second);
  account.filled_ns = now_ns;
}

absl::Status CallerQuota::Admit(Accounts& accounts, bool privileged, Use use, double weight) {
  const QuotaLimits::Rate& rate = RateOf(use);
  Account& account = accounts[static_cast<size_t>(use)];
  if (account.used >= rate.at_a_time) {
    return absl::ResourceExhaustedError(absl::StrCat("this certificate has ", rate.at_a_time, " ",
                                                     NameOf(use), " under way, the limit"));
  }
  const int room = limits_.streams_in_all - (privileged ? 0 : limits_.streams_reserved);
  if (use == Use::kStream && streams_ >= room) {
    return absl::ResourceExhaustedError(
        absl::StrCat(streams_, " streams of operators are open, the limit for this role is ", room,
                     "; try again later"));
  }
  if (account.tokens < weight) {
    return absl::ResourceExhaustedError(absl::StrCat(rpc::kCalledTooOften, rate.per_second, " ",
                                                     NameOf(use), " a second; try again later"));
  }
  if (rate.reserve > 0 && account.reserve < weight) {
    return absl::ResourceExhaustedError(absl::StrCat(
        "this certificate has used up its reserve of ", rate.reserve, " ", NameOf(use),
        "; from now on ", rate.lasting_per_second, " a second; another operator's has its own"));
  }
  account.tokens -= weight;
  if (rate.reserve > 0) account.reserve -= weight;
  ++account.used;
  if (use == Use::kStream) ++streams_;
  return absl::OkStatus();
}

absl::StatusOr<CallerQuota::Ticket> CallerQuota::Take(const std::string& identity, bool privileged,
                                                      Use use, double weight) {
  const int64_t now_ns = clock_->Now().boottime_ns;
  absl::Status status;
  {
    MutexLock lock(&mu_);
    if (now_ns >= expire_at_ns_) Expire(now_ns);
    const auto [at, fresh] = accounts_.try_emplace(identity);
    for (size_t i = 0; i < kUseCount; ++i) {
      const QuotaLimits::Rate& rate = RateOf(static_cast<Use>(i));
      if (fresh) {
        at->second[i] = {.tokens = rate.burst, .reserve = rate.reserve, .filled_ns = now_ns};
      }
      Fill(at->second[i], rate, now_ns);
    }
    status = Admit(at->second, privileged, use, weight);
  }
  if (!status.ok()) {
    if (refused_) refused_();
    return status;
  }
  return Ticket(nullptr, [self = shared_from_this(), identity, use](std::nullptr_t) {
    self->Release(identity, use);
  });
}

void CallerQuota::Release(const std::string& identity, Use use) {
  MutexLock lock(&mu_);
  --accounts_.at(identity)[static_cast<size_t>(use)].used;
  if (use == Use::kStream) --streams_;
}

void CallerQuota::Expire(int64_t now_ns) {
  expire_at_ns_ = now_ns + kExpireEveryNs;
  for (auto it = accounts_.begin(); it != accounts_.end();) {
    bool in_use = false;
    for (size_t i = 0; i < kUseCount; ++i) {
      const QuotaLimits::Rate& rate = RateOf(static_cast<Use>(i));
      Fill(it->second[i], rate, now_ns);
      in_use |= it->second[i].used > 0 || it->second[i].tokens < rate.burst ||
                it->second[i].reserve < rate.reserve;
    }
    it = in_use ? std::next(it) : accounts_.erase(it);
  }
}

size_t CallerQuota::accounts() const {
  MutexLock lock(&mu_);
  return accounts_.size();
}

}  // namespace rips::operator_api
