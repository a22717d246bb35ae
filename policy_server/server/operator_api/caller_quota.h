// How much of the server one operator's certificate may use, so that a viewer cannot keep others
// from watching, nor robots from being judged.
//
// | use      | calls                                       | limits                              |
// |----------|---------------------------------------------|-------------------------------------|
// | kStream  | WatchRobots WatchAlerts Record              | streams at a time, in all too; a    |
// |          | GetAlertRecording PushBundle                | reserve for role operator and above |
// | kQuery   | all other calls of a viewer; AckAlerts,     | calls at a time, and a second; one  |
// |          | GetConfiguration and dry runs, which so use | that costs much counts for several  |
// |          | up no order                                 |                                     |
// | kOrder   | Raise DeEscalate Approve ResumeRules        | calls at a time, and a second, and  |
// |          | SendSignal DrillRobot Ban Unban ResetTerm   | in the long run: a separate account |
// |          | ActivateBundle RollBackBundle StopRollout   |                                     |
// |          | CreateEnrolmentToken RevokeEnrolmentToken   |                                     |
// |          | ShadowBundle SetMaintenance                 |                                     |
//
// Orders of one identity are therefore refused only for its own orders.
#ifndef RIPS_POLICY_SERVER_SERVER_OPERATOR_API_CALLER_QUOTA_H_
#define RIPS_POLICY_SERVER_SERVER_OPERATOR_API_CALLER_QUOTA_H_

#include <array>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <string>

#include "absl/base/thread_annotations.h"
#include "absl/status/statusor.h"
#include "services/base/clock.h"
#include "services/runtime/mutex.h"

namespace rips::operator_api {

enum class Use { kStream, kQuery, kOrder };
inline constexpr size_t kUseCount = 3;

struct QuotaLimits {
  struct Rate {
    int at_a_time = 0;
    double per_second = 0;
    double burst = 0;
    // In the long run, besides: so many a second, and so many in reserve; 0 = without such a limit.
    double lasting_per_second = 0;
    double reserve = 0;
  };
  // Of one identity.
  Rate streams = {.at_a_time = 16, .per_second = 2, .burst = 32};
  Rate queries = {.at_a_time = 8, .per_second = 20, .burst = 40};
  // Many: a raise is answered when it is durable, and one may be due of every robot.
  // Each leaves a record in the audit log, which a key in other hands must not fill: 90 MB a day.
  Rate orders = {.at_a_time = 1'024,
                 .per_second = 50,
                 .burst = 500,
                 .lasting_per_second = 1,
                 .reserve = 10'000};
  // Of all identities, and how many of these only operators and administrators get.
  int streams_in_all = 256;
  int streams_reserved = 32;
};

// Any thread.
class CallerQuota : public std::enable_shared_from_this<CallerQuota> {
 public:
  // Ends the use when it is dropped, on any thread.
  using Ticket = std::shared_ptr<void>;

  // Called for each refusal; may be null.
  using Refused = std::function<void()>;

  // `clock` is not owned and outlives this and all tickets.
  static std::shared_ptr<CallerQuota> Create(const Clock* clock, QuotaLimits limits = {},
                                             Refused refused = nullptr) {
    return std::shared_ptr<CallerQuota>(new CallerQuota(clock, limits, std::move(refused)));
  }

  // ResourceExhausted with the limit. `identity`: the URI of a certificate; `privileged`: its role
  // is operator or above. `weight`: so many calls in the rate.
  absl::StatusOr<Ticket> Take(const std::string& identity, bool privileged, Use use,
                              double weight = 1) ABSL_LOCKS_EXCLUDED(mu_);
  // Identities with an account; for tests.
  size_t accounts() const ABSL_LOCKS_EXCLUDED(mu_);

 private:
  struct Account {
    int used = 0;
    double tokens = 0;
    double reserve = 0;
    int64_t filled_ns = 0;
  };
  using Accounts = std::array<Account, kUseCount>;

  CallerQuota(const Clock* clock, QuotaLimits limits, Refused refused)
      : clock_(clock), limits_(limits), refused_(std::move(refused)) {}
  absl::Status Admit(Accounts& accounts, bool privileged, Use use, double weight)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  const QuotaLimits::Rate& RateOf(Use use) const;
  void Fill(Account& account, const QuotaLimits::Rate& rate, int64_t now_ns) const;
  void Release(const std::string& identity, Use use) ABSL_LOCKS_EXCLUDED(mu_);
  // Forgets identities that use nothing and may do all again.
  void Expire(int64_t now_ns) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);

  const Clock* clock_;
  const QuotaLimits limits_;
  const Refused refused_;
  mutable Mutex mu_;
  std::map<std::string, Accounts> accounts_ ABSL_GUARDED_BY(mu_);
  int streams_ ABSL_GUARDED_BY(mu_) = 0;
  int64_t expire_at_ns_ ABSL_GUARDED_BY(mu_) = 0;
};

}  // namespace rips::operator_api

#endif  // RIPS_POLICY_SERVER_SERVER_OPERATOR_API_CALLER_QUOTA_H_
