"""Simulated laboratory of the packaged example."""
import numpy as np, csv, gzip, io
import fixel
from fixel.model import Body, Disk, Polygon, Pusher, Scene, Tripod, PathDrive
W,H,R=0.100,0.080,0.005
RATE,T,SPEED=20.0,3.0,0.020
rng=np.random.default_rng(11)
rows=[]
mm=1e3
for k in range(40):
    surface="abs" if k%2==0 else "plywood"
    offset=float(np.round(rng.uniform(-30,30)))/1e3
    angle=np.radians(float(np.round(rng.uniform(-25,25))))
    x0,y0=rng.uniform(0.15,0.25),rng.uniform(-0.05,0.05); th=rng.uniform(-np.pi,np.pi)
    mu=0.22*np.exp(rng.normal(0,0.05))
    c,s=np.cos(th),np.sin(th)
    Rm=np.array([[c,-s],[s,c]])
    local0=np.array([-W/2-R-0.001,offset])
    d=np.array([np.cos(angle),np.sin(angle)])
    lead=0.2
    time=np.arange(0,T+1e-9,1/RATE)
    way=np.clip(time-lead,0,None)*SPEED*1.0
    local=local0+way[:,None]*d
    tip=np.array([x0,y0])+local@Rm.T
    wp=np.column_stack((time,tip,np.zeros(len(time))))
    scene=Scene(bodies=(Body(name="part",shape=Polygon([[-W/2,-H/2],[W/2,-H/2],[W/2,H/2],[-W/2,H/2]]),mass=0.5,pose=(x0,y0,th),support=Tripod(radius=0.038,friction=0.15 if surface=="abs" else 0.35)),),
      pushers=(Pusher(name="tip",shape=Disk(R),pose=None,drive=PathDrive(waypoints=wp),friction=mu),),duration=T)
    sim=fixel.simulate(scene,output_interval=1/RATE)
    assert sim.converged,(k,sim.status)
    tr=sim.pose["part"]; st=sim.time
    pose=np.column_stack([np.interp(time,st,tr[:,j]) for j in range(3)])
    noisy=pose+rng.normal(size=pose.shape)*[2e-4,2e-4,np.radians(0.15)]
    tipn=tip+rng.normal(size=tip.shape)*3e-5
    for t,p,q in zip(time,noisy,tipn):
        rows.append([f"{k:02d}",surface,f"{offset*mm:g}",f"{np.degrees(angle):.0f}",f"{t:.2f}",f"{p[0]*mm:.2f}",f"{p[1]*mm:.2f}",f"{np.degrees(p[2]):.2f}",f"{q[0]*mm:.2f}",f"{q[1]*mm:.2f}"])
b=io.StringIO(); w=csv.writer(b,lineterminator="\n")
w.writerow("push,surface,contact_offset_mm,push_angle_deg,time_s,x_mm,y_mm,theta_deg,tip_x_mm,tip_y_mm".split(","))
w.writerows(rows)
data=gzip.compress(b.getvalue().encode(),mtime=0)
open("/work/wt/b/src/fixel/datasets/example.csv.gz","wb").write(data); print(len(data),len(rows))
