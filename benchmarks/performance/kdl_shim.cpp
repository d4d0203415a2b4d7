// What the comparison needs of orocos KDL, as functions that ctypes can call.

#include <kdl/chain.hpp>
#include <kdl/chainexternalwrenchestimator.hpp>

namespace {

struct Peer {
  KDL::Chain chain;  // the estimator keeps a reference to it
  KDL::ChainExternalWrenchEstimator *estimator = nullptr;
  KDL::JntArray q, dq, tau;

  ~Peer() { delete estimator; }
};

void read(const double *from, KDL::JntArray &to) {
  to.data = Eigen::Map<const Eigen::VectorXd>(from, to.rows());
}

}  // namespace

extern "C" {

// A segment is 26 numbers: rotation (row by row) and origin of its frame in the one before, axis of
// its joint there (zero: it has none), mass, centre of mass and inertia about it (xx yy zz xy xz yz)
// in its own frame, inertia of the rotor.
void *kdl_new(int segments, const double *numbers, const double *gravity, double rate_hz,
              double gain_per_s, double filter) {
  Peer *peer = new Peer;
  for (const double *n = numbers; n < numbers + 26 * segments; n += 26) {
    const KDL::Rotation turn(n[0], n[1], n[2], n[3], n[4], n[5], n[6], n[7], n[8]);
    const KDL::Vector origin(n[9], n[10], n[11]), axis(n[12], n[13], n[14]);
    const KDL::RotationalInertia about(n[19], n[20], n[21], n[22], n[23], n[24]);
    const KDL::RigidBodyInertia body(n[15], KDL::Vector(n[16], n[17], n[18]), about);
    KDL::Joint joint;
    if (axis.Norm() > 0.5)
      joint = KDL::Joint(origin, axis, KDL::Joint::RotAxis, 1.0, 0.0, n[25]);
    peer->chain.addSegment(KDL::Segment(joint, KDL::Frame(turn, origin), body));
  }
  const unsigned int joints = peer->chain.getNrOfJoints();
  for (KDL::JntArray *each : {&peer->q, &peer->dq, &peer->tau}) each->resize(joints);
  const KDL::Vector down(gravity[0], gravity[1], gravity[2]);
  peer->estimator = new KDL::ChainExternalWrenchEstimator(peer->chain, down, rate_hz, gain_per_s, filter);
  return peer;
}

void kdl_delete(void *peer) { delete static_cast<Peer *>(peer); }

int kdl_start(void *handle, const double *q, const double *dq) {
  Peer *peer = static_cast<Peer *>(handle);
  read(q, peer->q);
  read(dq, peer->dq);
  return peer->estimator->setInitialMomentum(peer->q, peer->dq);
}

int kdl_update(void *handle, const double *q, const double *dq, const double *tau, double *wrench) {
  Peer *peer = static_cast<Peer *>(handle);
  read(q, peer->q);
  read(dq, peer->dq);
  read(tau, peer->tau);
  KDL::Wrench found;
  const int error = peer->estimator->JntToExtWrench(peer->q, peer->dq, peer->tau, found);
  for (int k = 0; k < 6; ++k) wrench[k] = found(k);
  return error;
}

}  // extern "C"
