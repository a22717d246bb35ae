// How long certificates still last: a gauge each, and word of it when a third and when a tenth of
// the lifetime is left, and at the end, once each for a certificate.
//
//   rips_certificate_expiry_seconds{whose="own|peer", role, name}    until notAfter; negative after
//
// `name` is ROBOT/HOST of an agent, else the name in the identity.
#ifndef RIPS_SERVICES_RPC_CERTIFICATE_MONITOR_H_
#define RIPS_SERVICES_RPC_CERTIFICATE_MONITOR_H_

#include <cstddef>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/time/time.h"
#include "services/base/clock.h"
#include "services/rpc/peer.h"
#include "services/runtime/await.h"
#include "services/runtime/config_sections.h"
#include "services/runtime/metrics.h"
#include "services/runtime/mutex.h"
#include "services/runtime/ticker.h"

namespace rips::rpc {

enum class LifeStage { kGood, kThird, kTenth, kExpired };

// What is left at `now` of a life from `begin` to `end`: kThird at a third or less, kTenth at a
// tenth or less, kExpired after `end`.
LifeStage StageOf(absl::Time begin, absl::Time end, absl::Time now);

class CertificateMonitor {
 public:
  // Peers remembered; of more there is neither gauge nor notice.
  static constexpr size_t kPeersMax = 8'192;

  struct Notice {
    Peer certificate;
    LifeStage stage = LifeStage::kThird;
    bool own = false;
    absl::Duration left;
  };
  // A message: `certificate URI serial N expires in 3d`.
  static std::string Text(const Notice& notice);

  struct Options {
    TlsFiles own;
    // Called on the monitor's thread. Logged in any case. May be empty.
    std::function<void(const Notice&)> notify;
    // Between looks; InfiniteDuration = only when asked.
    absl::Duration interval = absl::Seconds(1);
  };

  // `clock` and `metrics` are not owned and outlive this.
  CertificateMonitor(Options options, const Clock* clock, Metrics* metrics);

  // A peer has been admitted with this certificate. Any thread.
  void Seen(const Peer& peer) ABSL_LOCKS_EXCLUDED(mu_);
  // Sorted by identity; any thread.
  std::vector<Peer> peers() const ABSL_LOCKS_EXCLUDED(mu_);
  // OK if connections can be made now with what the files hold. Any thread.
  absl::Status own_status() const ABSL_LOCKS_EXCLUDED(mu_);

  // Reads the own certificate, sets the gauges, gives the notices that are due. Logs a key that is
  // open to others now, as a renewal may leave it: a daemon refuses it at its start (key_mode.h),
  // and one that runs must not stop for it.
  void Check() ABSL_LOCKS_EXCLUDED(mu_);

 private:
  struct Watched {
    Peer certificate;
    LifeStage told = LifeStage::kGood;
    Gauge left;
  };
  void PutLocked(const std::string& key, const Peer& peer, bool own)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);

  const Options options_;
  const Clock* clock_;
  Metrics* metrics_;
  mutable Mutex mu_;
  // By URI; the own one under the empty key.
  std::map<std::string, Watched> watched_ ABSL_GUARDED_BY(mu_);
  RepeatFilter open_key_ ABSL_GUARDED_BY(mu_);
  absl::Status own_status_ ABSL_GUARDED_BY(mu_) = absl::UnavailableError("not read yet");
  std::optional<Ticker> ticker_;  // last: uses the others
};

}  // namespace rips::rpc

#endif  // RIPS_SERVICES_RPC_CERTIFICATE_MONITOR_H_
