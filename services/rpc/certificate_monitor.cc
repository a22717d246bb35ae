#include "services/rpc/certificate_monitor.h"

#include <utility>

#include "absl/strings/str_cat.h"
#include "services/rpc/credentials.h"
#include "services/runtime/key_mode.h"
#include "services/runtime/log.h"

namespace rips::rpc {
namespace {

std::string ShortName(const PeerIdentity& identity) {
  return identity.robot.empty() ? identity.name : absl::StrCat(identity.robot, "/", identity.host);
}

}  // namespace

LifeStage StageOf(absl::Time begin, absl::Time end, absl::Time now) {
  const absl::Duration life = end - begin;
  const absl::Duration left = end - now;
  if (left < absl::ZeroDuration()) return LifeStage::kExpired;
  if (left <= life / 10) return LifeStage::kTenth;
  if (left <= life / 3) return LifeStage::kThird;
  return LifeStage::kGood;
}

std::string CertificateMonitor::Text(const Notice& notice) {
  const std::string who =
      absl::StrCat(notice.own ? "own certificate " : "certificate ", Describe(notice.certificate));
  if (notice.stage == LifeStage::kExpired) {
    return absl::StrCat(who, " has expired; renew it");
  }
  return absl::StrCat(who, " expires in ",
                      absl::FormatDuration(absl::Trunc(notice.left, absl::Seconds(1))),
                      ", less than a ", notice.stage == LifeStage::kTenth ? "tenth" : "third",
                      " of its lifetime; renew it");
}

CertificateMonitor::CertificateMonitor(Options options, const Clock* clock, Metrics* metrics)
    : options_(std::move(options)), clock_(clock), metrics_(metrics) {
  if (options_.interval == absl::InfiniteDuration()) return;
  ticker_.emplace(absl::ZeroDuration(), [this] {
    Check();
    return options_.interval;
  });
}

void CertificateMonitor::PutLocked(const std::string& key, const Peer& peer, bool own) {
  if (watched_.size() > kPeersMax && !watched_.contains(key)) return;
  Watched& watched = watched_[key];
  if (watched.certificate.serial == peer.serial && watched.certificate.identity == peer.identity) {
    return;
  }
  watched.certificate = peer;
  watched.told = LifeStage::kGood;
  watched.left = metrics_->AddGauge("rips_certificate_expiry_seconds",
                                    "Seconds until a certificate expires; negative when it has.",
                                    {{"whose", own ? "own" : "peer"},
                                     {"role", std::string(RoleName(peer.identity.role))},
                                     {"name", ShortName(peer.identity)}});
}

void CertificateMonitor::Seen(const Peer& peer) {
  MutexLock lock(&mu_);
  PutLocked(ToString(peer.identity), peer, /*own=*/false);
}

std::vector<Peer> CertificateMonitor::peers() const {
  std::vector<Peer> peers;
  MutexLock lock(&mu_);
  for (const auto& [key, watched] : watched_) {
    if (!key.empty()) peers.push_back(watched.certificate);
  }
  return peers;
}

absl::Status CertificateMonitor::own_status() const {
  MutexLock lock(&mu_);
  return own_status_;
}

void CertificateMonitor::Check() {
  const absl::StatusOr<Peer> own = ReadOwnCertificate(options_.own);
  const absl::Time now = absl::FromUnixNanos(clock_->Now().unix_ns);
  std::string warning;
  const absl::Status private_key = CheckKeyMode(options_.own.key, &warning);
  std::vector<Notice> notices;
  {
    MutexLock lock(&mu_);
    own_status_ = own.status();
    if (private_key.ok()) {
      if (open_key_.said()) LogInfo("the private key is private again");
      open_key_.Clear();
    } else if (open_key_.Pass(private_key.message(), clock_->Now().boottime_ns)) {
      LogError("the next start will refuse the private key", {{"reason", private_key.message()}});
    }
    if (own.ok()) PutLocked("", *own, /*own=*/true);
    for (auto& [key, watched] : watched_) {
      const Peer& peer = watched.certificate;
      watched.left.Set(absl::ToDoubleSeconds(peer.not_after - now));
      const LifeStage stage = StageOf(peer.not_before, peer.not_after, now);
      if (stage <= watched.told) continue;
      watched.told = stage;
      notices.push_back(
          {.certificate = peer, .stage = stage, .own = key.empty(), .left = peer.not_after - now});
    }
  }
  for (const Notice& notice : notices) {
    if (notice.stage == LifeStage::kThird) {
      LogWarning(Text(notice));
    } else {
      LogError(Text(notice));
    }
    if (options_.notify) options_.notify(notice);
  }
}

}  // namespace rips::rpc
